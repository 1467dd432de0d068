"""What an option may be: numbers within their range, files of the kind that is needed, outputs that are new."""

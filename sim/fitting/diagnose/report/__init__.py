"""What a diagnosis says: verdict, sentences, findings.json, pictures, the page."""

"""Studies: measurements behind decisions, kept so that they can be made again. Nothing else imports them."""

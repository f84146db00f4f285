"""A target behind SSH: its keys, logins and connections."""

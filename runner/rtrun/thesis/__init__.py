"""What the thesis of 2014 published and claimed, and what a campaign says about it."""

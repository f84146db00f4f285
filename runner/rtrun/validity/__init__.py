"""Does a run count? Was it as asked for, do its counts add up, did its programs end well?"""

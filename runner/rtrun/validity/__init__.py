"""Does a run count? Was it as requested, do its counts add up, did its programs end well?"""

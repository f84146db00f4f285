"""Does a run count: was it as asked for, do its counts add up, did its programs end well."""

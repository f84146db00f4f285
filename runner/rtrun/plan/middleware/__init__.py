"""The middlewares through which suites measure: one file of data each."""

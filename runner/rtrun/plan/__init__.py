"""What to measure: suites, conditions, and the campaign that combines them. Nothing here knows a target."""

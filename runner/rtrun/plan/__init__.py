"""What shall be measured: suites, conditions, and the campaign that combines them. Nothing here knows a target."""

"""Pictures: charts of the report, and the logs drawn without gnuplot."""

"""Files at the edge of the system: YAML read into types, files written whole, builds cached by content.

Both ``rtgen`` and ``rtrun`` stand on this package; it knows nothing of either.
"""

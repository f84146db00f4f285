"""BitBake imports it; the package on PyPI leaves it out, and nothing here uses it."""

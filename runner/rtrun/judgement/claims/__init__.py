"""The claims of the thesis, each examined on the samples at hand."""

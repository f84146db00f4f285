"""How is it shown? What was judged, written down in one of several formats."""

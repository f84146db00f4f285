"""How is a kind of measurement read? One module for each kind; `known.py` has them all."""

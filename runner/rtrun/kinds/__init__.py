"""How is a kind of measurement read? One module a kind, `known.py` has them all."""

"""How is it shown? Judgements, written in one of several formats."""

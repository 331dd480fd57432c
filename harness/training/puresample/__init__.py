"""How materials are learned from random walks alone."""

"""How neural materials are made: recipes, training, energies, quality, previews."""

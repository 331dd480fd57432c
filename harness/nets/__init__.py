"""Building blocks of fitted methods: each once in torch, to fit, and once over columns, to run."""

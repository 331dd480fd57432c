"""Materials: reflectance functions and their conditions. One kind, one file."""

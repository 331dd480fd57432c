"""What a method and a material are. Imports torch alone."""

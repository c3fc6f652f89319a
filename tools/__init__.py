"""Scripts run by make: installation and demo."""

"""Independent references: slow, plain numpy, sharing no kernel with what they judge."""

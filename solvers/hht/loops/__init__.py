"""What every loop is written with: their memory, views of its sections, calls by address, the decorators."""

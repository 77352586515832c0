"""What an optional part of a scene costs where it is there and where it is not, and what every automatic reduction gains."""

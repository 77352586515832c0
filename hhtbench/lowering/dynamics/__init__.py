"""Terms of a system's equations of motion, its constraint levels and its accelerations."""

"""Events: sign changes within a step, and the step that ends at one."""

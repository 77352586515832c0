"""Step-size control: local error, controller, first step."""

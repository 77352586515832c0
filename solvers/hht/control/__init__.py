"""How long the steps are: the local error, the controller, the first step."""

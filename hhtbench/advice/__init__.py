"""Choose a solver: error against cost measured on one's own problem, and advice from known problems with its regret."""

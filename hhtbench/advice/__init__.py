"""From rows to a decision: the trade of error against cost on one's own scene, and advice with measured regret."""

"""One parameter after the other up to its extremes, each judged by what is known without any solver."""

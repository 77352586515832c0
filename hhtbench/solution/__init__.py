"""A solve: its request, its result, the counters and the files of both."""

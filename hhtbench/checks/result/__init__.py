"""Is the success that a solver reports believable, whoever wrote it?"""

"""The commands of the command line, one module each; ``hhtbench.cli.main`` imports the one that is asked for."""

"""The commands of the command line, one module each; ``hhtbench.cli`` imports the one that is asked for."""

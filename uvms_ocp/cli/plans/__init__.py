"""What is to be planned in, from the command line; a plan, its figures and its scene out."""

"""In: the symbolic dynamics of a vehicle and quantities as expressions. Out: forces, steps in time and their derivatives."""

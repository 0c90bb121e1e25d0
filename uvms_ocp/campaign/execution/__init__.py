"""Where runs are made. In: numbers of runs. Out: their rows, in any order, whatever becomes of the processes."""

"""What a campaign says. In: the folder of one. Out: rates with intervals, causes, distributions, sensitivities, the worst."""

"""What is uncertain, as values: named parameters, their distributions, and how they are drawn. In: a scenario. Out: its run k."""

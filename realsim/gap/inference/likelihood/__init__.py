"""How well a simulator with some causes explains the logs: weighted errors, sensitivities, the linear model."""

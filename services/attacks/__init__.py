"""Goals, budgets, traces and the attacks themselves."""

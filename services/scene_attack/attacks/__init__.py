"""Goals, budgets, traces, the attack loop, and one module for each attack."""

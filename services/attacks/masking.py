"""The alarm for masked gradients: Square, which needs none, where a gradient attack held."""

from dataclasses import replace

from services.attacks.problem import AttackProblem
from services.attacks.run import Budget, Verifier, run
from services.attacks.square import Square, SquareMethod


def check_masking(problem: AttackProblem, verifier: Verifier, queries: int) -> dict[str, object]:
    """Attacks the problem by Square with at most `queries` steps and within the same limits. Returns its outcome.

    `square` is "fooled" if it found a verified adversary, else "held"; `queries` is the number of its steps. Where the
    gradient attack held and Square succeeds, the gradient misled the former. Queries and renders are counted on
    `problem` and `verifier`. Raises as `run` does.
    """
    own = replace(problem, loss="margin", queries=0, renders=0)
    settings = Square.model_construct(epsilon=dict(problem.epsilon), steps=queries)
    found = run(own, SquareMethod(settings, own), verifier, Budget(queries))
    problem.queries += own.queries
    problem.renders += own.renders
    return {"square": "fooled" if found.verified else "held", "queries": found.step}

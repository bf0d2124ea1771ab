"""The study of docs/study: the paper's two tables on furniture, from committed results of campaigns.

- `python -m benchmarks.study record out/paper-differentiable differentiable` makes
  docs/study/differentiable.json and its example images of the folder of a campaign that has been run;
- `python -m benchmarks.study page` writes the page and its curves from these files and from the hand-written text in
  classification.md of this folder.
"""

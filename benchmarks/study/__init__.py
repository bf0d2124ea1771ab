"""The study of docs/study: the paper's tables, of object classification on furniture and of visual question answering
on scenes after CLEVR, from committed results of campaigns.

- `python -m benchmarks.study record out/paper-differentiable differentiable` makes
  docs/study/differentiable.json and its example images of the folder of a campaign that has been run;
- `python -m benchmarks.study page` writes the pages and their curves from these files and from the hand-written texts
  in this folder, classification.md and vqa.md.
"""

"""Inferring and executing programs (IEP, Johnson et al. 2017): a question's program assembles a network from modules.

A program generator turns a question into a functional program. The engine assembles the modules of its functions into
one network over image features, whose scores are over the 28 answers.

Departures from the published network: the trunk is small and trained here. Modules are 1×1 convolutions, take
coordinates and what their inputs attend to, and see the cells that are likeliest to hold an object. A set or an object
passes from module to module as its attention mask, in place of 128 channels. A count, a truth value or an attribute
passes as a vector, and a classifier gives it scores. `unique` passes its input on.
"""

"""A network of one's own process: a torch module, and a function that returns scores, which has no gradients."""

import torch

import scene_attack as sa

torch.manual_seed(0)
layers = [torch.nn.Conv2d(3, 16, 5, 4), torch.nn.ReLU(), torch.nn.AdaptiveAvgPool2d(2), torch.nn.Flatten()]
module = torch.nn.Sequential(*layers, torch.nn.Linear(64, 5))
labels, preprocessing = ("ant", "bee", "cat", "dog", "elk"), sa.Preprocessing(input_size=(32, 32))
scene = sa.Scene(camera=sa.Camera(size=(64, 64)), objects=[sa.Object(mesh="primitive/sphere", material="plastic")])

network = sa.target(module, labels=labels, preprocessing=preprocessing)
by_gradients = sa.attack(scene, network, sa.FGSM(renderer="torch", steps=40))
print("module:", by_gradients.original.label, "→", by_gradients.attacked.label, by_gradients.outcome)

scores = sa.target(lambda images: module(images).numpy(), labels=labels, preprocessing=preprocessing)
by_scores = sa.attack(scene, scores, sa.Square(renderer="image", steps=200), goal=sa.Goal(truth="elk"))
print("function:", by_scores.original.label, "→", by_scores.attacked.label, by_scores.outcome)

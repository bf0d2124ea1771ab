"""A campaign as objects: two attacks on two views of a cube before a network of one's own, as a DataFrame."""

import torch

import scene_attack as sa

torch.manual_seed(0)
layers = [torch.nn.Conv2d(3, 16, 5, 4), torch.nn.ReLU(), torch.nn.AdaptiveAvgPool2d(2), torch.nn.Flatten()]
module = torch.nn.Sequential(*layers, torch.nn.Linear(64, 5))
target = sa.target(module, labels=list("abcde"), preprocessing=sa.Preprocessing(input_size=(32, 32)), name="mine")
cube = sa.Object(mesh="primitive/cube", material="plastic")
scenes = [sa.Scene(camera=sa.Camera(azimuth=angle, size=(64, 64)), objects=[cube]) for angle in (0.3, 0.9)]
attacks = [
    {"name": "image", "attack": sa.FGSM(renderer="image", steps=20)},
    {"name": "light", "attack": sa.FGSM(renderer="torch", groups=["illumination"], steps=20)},
]
grid = sa.Grid(scenes=scenes, targets=["mine"], attacks=attacks, selection={"right": False})
run = sa.campaign(sa.Campaign(name="cubes", grids=[grid]), out="study", targets=[target])
print(run.to_frame()[["attack", "azimuth", "original", "attacked", "outcome"]].to_string(index=False))

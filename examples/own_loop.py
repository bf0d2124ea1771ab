"""A loop of one's own: Adam moves the light of a scene, through the renderer's gradient, until one half is brighter."""

import torch

import scene_attack as sa

torus = sa.Object(mesh="primitive/torus", material="plastic")
scene = sa.Scene(camera=sa.Camera(size=(64, 64)), objects=[torus])
renderer = sa.renderer(scene, "torch", groups=["illumination"])
low, high = renderer.bounds()["illumination"]
light = renderer.initial()["illumination"][None].clone().requires_grad_()
optimiser = torch.optim.Adam([light], lr=0.5)
differences = []
for _ in range(30):
    image = renderer.render({"illumination": light})  # [1, 64, 64, 3] in [0, 1]
    difference = image[:, :, 32:].mean() - image[:, :, :32].mean()
    differences.append(difference.item())
    optimiser.zero_grad()
    (-difference).backward()
    optimiser.step()
    with torch.no_grad():
        light.clamp_(low, high)
print(f"right minus left: {differences[0]:+.3f} → {differences[-1]:+.3f}")

"""A mesh of one's own, by the path of its file, before a network that comes with the project."""

import trimesh

import scene_attack as sa

trimesh.creation.capsule(height=1.0, radius=0.4).export("capsule.obj")
capsule = sa.Object(mesh="./capsule.obj", material="plastic", color=(0.8, 0.2, 0.1))
scene = sa.Scene(camera=sa.Camera(azimuth=0.6, size=(128, 128)), objects=[capsule])
attack = sa.FGSM(renderer="torch", groups=["normals", "illumination"], steps=40)
result = sa.attack(scene, "efficientnet-lite0", attack, seed=0)
print(f"{result.original.label} → {result.attacked.label}, verified: {result.verified}")
print(f"p = {result.perceptibility:.4f} after {result.record.cost.steps} steps")
result.save("capsule")

"""What is in front of the camera: descriptions, meshes, environment maps, built-in scenes."""

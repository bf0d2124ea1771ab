"""Templates of questions: their families, their instances in a scene, their programs and their wording."""

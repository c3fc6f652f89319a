"""``fluidsnet inspect --model``: what a model builds for a scene, and what it leaves out."""

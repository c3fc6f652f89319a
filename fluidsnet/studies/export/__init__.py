"""``fluidsnet export``: simulations as files for Houdini, Blender, Maya and ParaView."""

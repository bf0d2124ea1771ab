"""A plug-in: the renderer `stock-pyrender`, for second opinions. It draws a scene's export as anybody would draw it."""

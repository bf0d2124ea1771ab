"""Reads files of others, each in a confined process: meshes with the files that they name, maps, images, zip files."""

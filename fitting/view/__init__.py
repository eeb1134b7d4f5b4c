"""The live view: a material as it looks while its parameters are moved, in a browser's page and in notebooks."""

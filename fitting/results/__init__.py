"""The result of a material as JSON, and the manifest of a folder of them."""

"""The rival reflectance models of the literature, one file each."""

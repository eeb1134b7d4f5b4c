"""RENDERING: scenes, what effects their pictures call for, and the pictures; knows models, no file format of fits."""

"""From a file to a result in a folder: the stages, one after the other, for one material or many."""

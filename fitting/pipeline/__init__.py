"""From a file to a result: the stages, one after the other, for one material or many."""

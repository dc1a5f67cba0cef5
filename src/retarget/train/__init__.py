"""Learning: data, a loop, and one recipe for each network. Of the package, only this and `evaluate/reference` import torch."""

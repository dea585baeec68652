"""Hand-made control laws: the paper's expert, its variants, and simple laws to compare with."""

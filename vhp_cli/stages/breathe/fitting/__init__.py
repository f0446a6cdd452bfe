"""Find the motion of every tissue of a model: one module for each group of tissues."""

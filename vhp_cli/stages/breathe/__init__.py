"""Respiratory motion of a torso model: sequences of motions, their fit, their proof and their scripts."""

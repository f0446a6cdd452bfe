"""Compiled inner loops: small, pure, each with a plain reference beside its test."""

"""Stages: one surface in, a better one out; nothing here touches the disk."""

"""Truths: terrains, rooms, crossings and plants whose right answers are known. Tests and benchmarks both use them."""

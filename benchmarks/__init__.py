"""Measured workloads, a report, and a gate against the committed baseline: `python -m benchmarks [group ...]`."""

"""The error terms of the batch estimation, and their normal equations."""

"""A package with a term and a body of one's own: docs/environments/your_own.md."""

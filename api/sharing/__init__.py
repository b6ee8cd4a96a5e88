"""A job as a file for others: a zip to run it again, and a report to look at."""

"""A training run for other tools: event files for TensorBoard, a run for Weights & Biases.

Never the job's own business: it runs in processes of its own, with time limits, and what goes wrong there
is a note. The key of Weights & Biases goes to one of these processes alone, through its environment.
"""

"""Keeps as many workers on a cluster as the queue wants. The cluster's scheduler places and stops them.

launcher   the seam: start workers of a kind, say what runs, stop
scale      the decision, as a pure function: what the queue wants and what runs → starts and stops
options    what a site says: partitions, accounts, limits, containers, tunnels
slurm      the seam on sbatch, squeue and scancel
script     the batch script
stores     how a worker on a compute node reaches the stores
main       the process, `gaitway cluster slurm`
"""

"""The tools of all benches: processes and runs, statistics, results, and the page made from them."""

"""A campaign that tries to break what docs/reliability.md promises: real processes, seeded faults, a checker.

world      the servers and processes of a service, each behind proxies, and what is done to them
proxy      what stands between any two parts, and misbehaves when asked
training   a training process without physics, whose every byte can be foretold
worker     the real worker, which starts that one
clients    users: they submit, cancel, follow, and write down what they were told
faults     what goes wrong, drawn from a seed
outages    other faults, none of which may cost an attempt
damage     objects that the store has lost or cannot give
volumes    SeaweedFS's files, in which a byte is changed
checker    what must hold of what the users wrote down
episode    all of it together, once
"""

"""Speed alone: the spring simulator in a memory layout that suits CPUs; ``brax_robots.make(as_brax=True)`` skips it."""

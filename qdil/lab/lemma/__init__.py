"""Lemma 1 put to the test: exactly on a small Markov decision process, and by sampling on a robot."""

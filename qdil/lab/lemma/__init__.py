"""Tests of Lemma 1: exactly on a small Markov decision process, and by sampling on a robot.

The lemma says that PPO on the bonus 1[m ∈ A_e] does not lower P(m ∈ A_e | π), the probability that an episode's
measures m fall into an empty cell of the archive. A *trial* is one policy, one archive and one improvement by PPO.
"""

"""Small experiments that a notebook computes live: the background algorithms, Lemma 1, single steps and iterations."""

"""PPGA's parts: rollouts, VPPO, evaluation, xNES, the archives."""

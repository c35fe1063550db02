"""Reward models, one file each; ``qdil.methods`` lists them in the order of the paper's Table 1, DiffAIL last."""

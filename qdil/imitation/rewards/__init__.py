"""The paper's reward models, one file each; ``qdil.methods`` names them in the order of its Table 1."""

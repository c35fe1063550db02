"""The paper's tables, figures and claims from finished runs, with intervals. Imports no JAX."""

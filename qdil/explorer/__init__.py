"""The archive explorer: click a cell, watch that robot move; in a notebook, in a page of its own, or in a film."""

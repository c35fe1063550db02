"""For people at a terminal: the bench, plans, verification, a look inside an iteration."""

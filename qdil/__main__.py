"""``python -m qdil``: the same command line as ``qdil``."""

import sys

from qdil.cli import main

sys.exit(main())

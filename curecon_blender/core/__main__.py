# SPDX-FileCopyrightText: 2026 CU-Recon authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m curecon_blender.core`: the command line, the same entry that the add-on's worker uses."""

import sys

from .base.allocator import use_large_pages
from .run.worker import main

if __name__ == "__main__":
    use_large_pages()
    sys.exit(main())

# SPDX-License-Identifier: Apache-2.0
"""Who may do what in the cell (data/access.yaml), and the keys that prove who is who.

Pure: no ROS. ``policy`` reads the file, ``zenoh_access`` and ``sros2`` write it in the words of the two middlewares,
``certificates`` and ``keystore`` make the keys.
"""

from softgrip_security.errors import SecurityError

__all__ = ["SecurityError"]

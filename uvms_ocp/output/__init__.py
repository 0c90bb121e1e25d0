"""Names of files in, a folder out that holds all of a command's results or all of the earlier ones, and what is foreign.

What is guaranteed of a folder, whatever moment a command is killed at:

- Each of our files is whole at any time, an old one or a new one.
- After the next command that writes to the folder or reads it, all are old or all are new, and nothing else is left over.
- A file that no command of ours wrote, or that was changed since, is neither replaced nor removed: a command that would
  have to is refused before its work begins.
- After a loss of power the same holds as far as the disk keeps what `os.fsync` reported as written.

Beside the results stands the folder `.uvms_ocp`: the manifest of what we wrote, and during a replacement the new files,
the old ones and the journal that says which of them belong where.
"""

from uvms_ocp.output.claim import Claim as Claim
from uvms_ocp.output.claim import claimed as claimed
from uvms_ocp.output.claim import settle as settle

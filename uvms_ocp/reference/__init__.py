"""The reference: what every public name does, the theory with the code that states it, files,
series and commands.

In: the package itself and the pages of ``theory/``. Out: a folder of HTML that needs no network.
``python -m uvms_ocp.reference FOLDER`` builds it with ``pip install "uvms-ocp[reference]"``.
"""

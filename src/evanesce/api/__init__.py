"""The public Python API, one module for each noun; ``import evanesce as ev`` offers all of it.

======================  =====================================================================
:mod:`~.scenes`         load, build, change and save the rig as data
:mod:`~.contact`        solve the contact of a finger with the glass
:mod:`~.own_rig`        a scene of one's own rig, from a preset and answers
:mod:`~.camera`         take frames of a scene, with the truth of each
:mod:`~.calibrate`      calibrate a camera from frames of the printed targets
:mod:`~.measure`        measure the contact area in a frame
:mod:`~.compare`        compare a measurement with the truth
:mod:`~.dataset`        make labelled samples in memory
:mod:`~.bundles`        read a lab's measurement, and find where the simulation departs from it
======================  =====================================================================
"""

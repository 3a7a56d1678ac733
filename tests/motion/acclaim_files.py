"""A small Acclaim skeleton and a motion of it."""

ASF = """:version 1.10
:units
  mass 1.0
  length 0.45
  angle deg
:root
   order TX TY TZ RX RY RZ
   axis XYZ
   position 0 0 0
   orientation 0 0 0
:bonedata
  begin
     name thigh
     direction 0 -1 0
     length 7.0
     axis 0 0 90 XYZ
     dof rx ry
     limits (-160.0 20.0)
            (-70.0 70.0)
  end
  begin
     name shin
     direction 0 -1 0
     length 8.0
     axis 0 0 0 XYZ
  end
:hierarchy
  begin
    root thigh
    thigh shin
  end
"""
AMC = """# a comment
:FULLY-SPECIFIED
:DEGREES
1
root 0 18 9 0 0 0
thigh 30 0
2
root 0 18 9 0 90 0
thigh 0 0
"""


def write_acclaim(folder, *, asf=ASF, amc=AMC):
    """Writes both files and returns the motion's."""
    (folder / "02.asf").write_text(asf)
    (folder / "02_01.amc").write_text(amc)
    return folder / "02_01.amc"

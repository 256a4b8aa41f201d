from swarmd.sensing.conditioning_numpy import RayMemory as RayMemory
from swarmd.sensing.deskew_numpy import move_rays as move_rays
from swarmd.sensing.deskew_numpy import rays_in_sector as rays_in_sector
from swarmd.sensing.rays_numpy import closest_points as closest_points
from swarmd.sensing.rays_numpy import clusters as clusters
from swarmd.sensing.rays_numpy import nearest as nearest
from swarmd.sensing.rays_numpy import unit_vectors as unit_vectors

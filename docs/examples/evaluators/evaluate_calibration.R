# Evaluates a calibration document (docs/model.md) in R, with the package jsonlite.
#   document <- jsonlite::fromJSON("calibration.json")
#   project(document, c(east, north, up))     x, y in px
#   back_project(document, c(x, y))           east, north, up (closed form)
#   holding(document, c(x, y), 0.95)          the stated sigmas within which a share of the errors at a pixel lies
ideal <- list(
  perspective = list(tan, atan),
  equidistant = list(identity, identity),
  equisolid = list(function(t) 2 * sin(t / 2), function(r) 2 * asin(r / 2)),
  stereographic = list(function(t) 2 * tan(t / 2), function(r) 2 * atan(r / 2)),
  orthographic = list(sin, asin)
)

rotation <- function(w) { # of a rotation vector (Rodrigues)
  angle <- sqrt(sum(w^2))
  a <- if (angle > 0) w / angle else w
  K <- matrix(c(0, a[3], -a[2], -a[3], 0, a[1], a[2], -a[1], 0), 3)
  diag(3) + sin(angle) * K + (1 - cos(angle)) * K %*% K
}

shift <- function(c, r, point) { # decentering, p1 ... p4 or q1 ... q5
  u <- if (r > 0) point[1] / r else 1
  v <- if (r > 0) point[2] / r else 0
  g <- r^2 * (1 + sum(c[-(1:2)] * r^(2 * seq_along(c[-(1:2)]))))
  g * c(c[1] * (1 + 2 * u^2) + 2 * c[2] * u * v, 2 * c[1] * u * v + c[2] * (1 + 2 * v^2))
}

displaced <- function(document, pixel) { # by the field's mean
  f <- document$uncertainty$field
  if (length(f$orders) == 0) return(pixel)
  place <- (pixel - f$center_px) / f$half_px + 1
  waves <- sin(pi / 2 * f$orders[, 1] * place[1]) * sin(pi / 2 * f$orders[, 2] * place[2]) / sqrt(prod(f$half_px))
  pixel + (min(place) > 0 && max(place) < 2) * as.vector(f$mean %*% waves)
}

project <- function(document, direction) {
  m <- document$model
  ray <- as.vector(rotation(m$rotation_cam_enu) %*% direction) + m$translation
  across <- sqrt(ray[1]^2 + ray[2]^2)
  theta <- atan2(across, ray[3])
  if (theta > m$max_angle_deg * pi / 180) return(c(NaN, NaN))
  r <- ideal[[m$projection]][[1]](theta) + sum(m$radial * (theta / (pi / 2))^(2:9))
  point <- if (across > 0) r * ray[1:2] / across else c(0, 0)
  point <- point + shift(m$decentering, r, point)
  x <- m$focal_length_px[1] * point[1] + m$skew_px * point[2] + m$principal_point_px[1]
  y <- m$focal_length_px[2] * point[2] + m$principal_point_px[2]
  displaced(document, c(if (document$image$mirrored) document$image$width - 1 - x else x, y))
}

back_project <- function(document, pixel) {
  m <- document$model
  b <- document$backward_model
  seen <- pixel
  for (i in 1:8) pixel <- seen - (displaced(document, pixel) - pixel)
  if (document$image$mirrored) pixel[1] <- document$image$width - 1 - pixel[1]
  y <- (pixel[2] - m$principal_point_px[2]) / m$focal_length_px[2]
  x <- (pixel[1] - m$principal_point_px[1] - m$skew_px * y) / m$focal_length_px[1]
  r <- sqrt(x^2 + y^2)
  point <- c(x, y) - shift(b$decentering, r, c(x, y))
  adjusted <- max(sqrt(sum(point^2)), .Machine$double.xmin)
  theta <- ideal[[m$projection]][[2]](adjusted - sum(b$radial * r^(2:9)))
  as.vector(t(rotation(m$rotation_cam_enu)) %*% c(sin(theta) * point / adjusted, cos(theta)))
}

holding <- function(document, pixel, share) {
  mixture <- document$uncertainty$mixture
  w <- if (is.null(mixture)) 1 else mixture$shares
  near <- if (is.null(mixture)) 1 else (1 + colSums((t(mixture$pixels_px) - pixel)^2))^-2
  s <- if (is.null(mixture)) 1 else as.vector(near %*% mixture$scales) / sum(near)
  t <- 0
  for (i in 1:60) { # Newton's method; what is outside falls with t and is convex
    outside <- w * exp(-t / (2 * s^2))
    t <- t + sum(outside) * log(sum(outside) / (1 - share)) / sum(outside / (2 * s^2))
  }
  sqrt(t)
}
